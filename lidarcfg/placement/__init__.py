"""Placement: where the LiDARs should sit."""
