"""Documents of ontologies: where they are read from, and in which formats."""
