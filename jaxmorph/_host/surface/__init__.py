"""Surfaces by their nodes: graphs, walls, gaps, neighbours."""
