"""Acquisition: sources of samples, the test set-up, and a recorder that loses nothing it has acknowledged.

A source gives blocks of samples, each with the tick (sample number) of its first one. A process of its own runs it and
hands the blocks on; another writes them to an HDF5 file and acknowledges each when it is on the disk.
"""
