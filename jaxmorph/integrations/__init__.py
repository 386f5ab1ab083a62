"""Components for other frameworks, one file each; each needs the extra of its name."""
