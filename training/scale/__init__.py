"""Jobs done here, by processes or by a Ray cluster; their results are kept on disk."""
