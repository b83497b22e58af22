"""Input decks of other programs, translated to case files."""
