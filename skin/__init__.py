"""Shared definitions: layout, measurement operator, taxel model, messages, fabric, and the ``skin`` command."""
