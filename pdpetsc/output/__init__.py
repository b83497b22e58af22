"""What a run leaves behind: fields, history, summary, checkpoint and picture."""
