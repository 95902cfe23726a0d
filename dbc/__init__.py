"""The bus contract: what every frame on the bus means, made from a layout."""
