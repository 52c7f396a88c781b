# SPDX-License-Identifier: Apache-2.0
"""Candidate frames that are not objects but projections: joint space, task spaces, null spaces (Eqs. 7 to 12)."""
