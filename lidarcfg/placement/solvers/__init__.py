"""Search methods behind one ask/tell protocol."""
