"""How much better a print gets, where, and than what: every method on a printer that none of them was designed with."""
