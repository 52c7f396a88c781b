# SPDX-License-Identifier: Apache-2.0
"""What can go wrong, what is promised then, and what is observed: real nodes, real topics, time that really passes.

``make faults`` runs all (``python -m faults --help``); ``test/test_faults.py`` runs the quick ones.
"""
