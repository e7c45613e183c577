"""Parts of recordings, cut out around failures."""
