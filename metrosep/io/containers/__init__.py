"""Files that hold several things in a tree: HDF5, TDMS, MATLAB, NumPy and workbooks."""
