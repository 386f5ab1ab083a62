"""What every room of the package uses: arguments, errors, files."""
