"""How well objects and postures are recognised, ours beside the paper's."""
