"""Networks of the twin: perceptrons with dropout that stays on, multi-head networks, causality DeepONets.

Nothing here knows the engine. Initialisation, structure and the use of dropout follow the paper (Nath et al., sections
"Neural network surrogates for empirical formulae", "DeepONets for EGR and VGT states" and "Training of multi-head
neural networks"). A network is made of its `spec()` (plain JSON) and its state dict; `save_state` and `load_state` keep
both in one file that is written atomically.
"""

from dieseltwin.networks.deeponet import CausalityDeepONet, DeepONetSizes, soft_clip, soft_clip_slope
from dieseltwin.networks.files import load_state, network_from_spec, save_state
from dieseltwin.networks.multi_head import MultiHead
from dieseltwin.networks.perceptron import ACTIVATIONS, MLP

__all__ = [
    "ACTIVATIONS", "MLP", "CausalityDeepONet", "DeepONetSizes", "MultiHead", "load_state",
    "network_from_spec", "save_state", "soft_clip", "soft_clip_slope",
]  # fmt: skip
