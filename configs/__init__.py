"""Sample rigs and parts; installed as the package ``lightopt.samples``, from which ``lightopt init`` copies."""
