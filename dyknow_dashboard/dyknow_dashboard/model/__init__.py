"""The contents of the page: turns reports of nodes into JSON documents, in bounded memory."""
