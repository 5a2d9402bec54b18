"""Version of the program, which files that it writes say."""

from typing import Final

VERSION: Final = "0.1.0"
