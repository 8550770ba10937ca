"""A rig that is not there: simulated firmware and a camera that sees what the firmware does."""
