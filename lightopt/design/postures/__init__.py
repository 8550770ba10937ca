"""Which postures of the part are imaged, with lights that stand the same in all of them."""
