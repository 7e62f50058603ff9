"""What fits say: documents and figures, made from their records alone."""
