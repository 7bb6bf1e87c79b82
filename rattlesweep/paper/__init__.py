"""The paper reproduced: every figure and every claim of Kondo and Nakanishi (2017)."""
