"""Equations of motion: compositions of a chart, a surface and actions.

:mod:`chart` says how a state places a body, :mod:`action` what acts on it, and
:mod:`model` composes the equations.  :mod:`sums` adds what several actions do, and
:mod:`fast` has cheaper equations for some sets of them.
"""
