"""Looking: a page in the browser, the same as one file, Open3D's window, and stills without a screen."""
