"""Identification of a hand's drive: record excitations, fit a model, write the hand's file.

`pipeline` is the entry, `report` the HTML page. `record_excitation` records a config's hand. `motions` has the
excitations and their recordings, `fitting` goes from these to a drive, `results` to values with uncertainties and the
hand's file.
"""
