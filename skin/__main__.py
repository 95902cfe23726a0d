"""``python -m skin`` is the ``skin`` command."""

from skin.command import main

main()
