"""``python -m skin`` is the ``skin`` command."""

from shell.command import main

main()
