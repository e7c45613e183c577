"""Fields of messages: the texts that name them."""
