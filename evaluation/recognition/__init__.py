"""How well objects and postures are told apart, ours beside the paper's."""
