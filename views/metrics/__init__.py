"""The figures of all skins of a hub for Prometheus."""
