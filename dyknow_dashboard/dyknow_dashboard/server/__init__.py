"""The server of the page: HTTP and WebSockets, which any program on the machine may speak to."""
