"""C99 firmware of the boards of a skin: sources, constants of each board, and a library that runs many boards."""
