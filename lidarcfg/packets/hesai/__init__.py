"""Hesai's packets."""
