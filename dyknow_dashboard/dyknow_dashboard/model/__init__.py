"""The contents of the page: from the reports of nodes to documents of JSON, in bounded memory."""
