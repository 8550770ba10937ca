"""Image files by format, all on top of OpenImageIO: a format is a module here."""
