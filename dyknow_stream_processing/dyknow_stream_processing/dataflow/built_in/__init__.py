"""Built-in sources, which are made of whole messages: frames, and the status of actions."""
