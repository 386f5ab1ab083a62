"""Arguments, errors and files: for every room of the package."""
