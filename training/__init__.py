"""The batched training environment, PPO, and the export to ONNX and card."""
