"""How far lights and part may be off."""
