# SPDX-License-Identifier: Apache-2.0
"""Programs: train, record, check a robot file; and their reports."""
