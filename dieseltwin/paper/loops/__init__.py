"""The paper's training loops: few-shot transfer, the hybrid PINN from scratch and in stages."""
