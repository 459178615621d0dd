"""Velodyne's packets."""
