"""Cells by their ids: types, faces, neighbours."""
