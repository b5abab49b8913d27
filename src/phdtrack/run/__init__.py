"""A run as a library: from a source to the files of a directory, without a command line."""
