"""What each command does: files in, files out, and the result as plain data.

The command line prints it; the demo calls the same functions. Nothing is written unless the whole result is
there.
"""
