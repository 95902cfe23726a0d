"""The bus contract: identifier, content and sender of every frame, computed from a layout."""
