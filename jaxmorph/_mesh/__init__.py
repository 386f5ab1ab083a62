"""The mesh: points, cells, patches, polyhedra, and exchange with meshio and PyVista."""
