"""Surfaces that touch, cross or pass through each other."""
