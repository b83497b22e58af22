"""Output of a run: fields, history, summary, checkpoint and picture."""
