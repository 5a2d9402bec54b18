"""What each command does: files in, files out, and a plain-data account of the result.

The command line prints the account; the demo calls the same functions. Nothing is written unless the whole result is
there.
"""
