"""The paper once more: every figure and every claim of Kondo and Nakanishi (2017)."""
