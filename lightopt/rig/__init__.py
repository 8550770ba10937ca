"""The machine: device drivers (`devices`), simulated devices (`simulated`), and capture sessions (`capture`)."""
