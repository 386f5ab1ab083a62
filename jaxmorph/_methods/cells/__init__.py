"""Methods that solve an equation on the cells of the mesh."""
