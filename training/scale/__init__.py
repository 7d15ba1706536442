"""Jobs done here, by processes or by a Ray cluster: results in their order, kept on disk."""
