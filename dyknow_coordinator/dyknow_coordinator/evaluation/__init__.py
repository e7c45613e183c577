"""The life of one evaluation, from request to answer."""
