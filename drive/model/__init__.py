"""A drive model: a folder of files, read and checked."""
