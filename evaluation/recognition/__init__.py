"""How well objects are recognised, ours beside the paper's."""
