"""Ouster's packets."""
