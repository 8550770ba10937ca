"""Where defects stay invisible, and why."""
