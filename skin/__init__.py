"""The shared vocabulary: layout, measurement operator, messages, fabric and the ``skin`` command."""
