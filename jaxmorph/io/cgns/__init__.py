"""CGNS files, in HDF5 and in ADF."""
