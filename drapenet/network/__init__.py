"""The network: its inputs, training, checkpoint, evaluation."""
