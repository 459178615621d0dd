"""Viewing: a page in the browser or as one file, Open3D's window, and stills without a screen."""
