"""How far a score falls when lights or part are misaligned: `_analysis`, on the scores of `_misaligned_scores`."""
