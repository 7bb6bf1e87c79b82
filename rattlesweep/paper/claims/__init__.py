"""The paper's claims, and what each is judged by."""
