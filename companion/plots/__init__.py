"""The style of every picture: colours, line styles and panels.

Gallery, papers, comparison, demonstration, Stanford diagram, flight report and live page take their
colours from `companion.plots.style`, and from nowhere else. The report and the live page share the
panels of `companion.plots.panels`.
"""
