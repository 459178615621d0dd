"""The makers' packets: a codec per family."""
