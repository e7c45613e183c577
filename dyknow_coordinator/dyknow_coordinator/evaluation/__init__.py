"""Life cycle of one evaluation, from request to answer."""
