"""Digital twin of a diesel engine's gas path: simulation and identification of its health parameters.

Paper: Nath, Kumar, Smith, Karniadakis, "A Digital Twin for Diesel Engines: Operator-infused Physics-Informed
Neural Networks with Transfer Learning for Engine Health Monitoring".
"""

__version__ = "0.1.0"
