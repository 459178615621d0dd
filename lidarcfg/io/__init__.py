"""Conversion: rigs, clouds and captures in the formats of other tools."""
