"""Large text files: sections, numbers, and edits in place."""
