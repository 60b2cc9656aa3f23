"""The mirror: a model beside the hand that detects contacts, faults and slips.

`factory` makes mirrors and `mirror` has the class; `on_recording` and `on_rig` run one over a recording or a config's
hand. `contact_detection` and `fault_detection` decide; the other modules detect one kind of fault each.
"""
