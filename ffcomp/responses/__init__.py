"""`ffcomp frf`: the model's frequency responses anywhere on the bed, and next to measured ones."""
