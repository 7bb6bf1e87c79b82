"""The paper's figures, and what each measures."""
