"""Results as pictures: an interactive page, and a static image for documents."""
