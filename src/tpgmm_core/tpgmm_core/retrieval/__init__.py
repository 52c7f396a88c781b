# SPDX-License-Identifier: Apache-2.0
"""Methods of retrieving a movement from a model (Section 3, end). Modules are imported by name."""
