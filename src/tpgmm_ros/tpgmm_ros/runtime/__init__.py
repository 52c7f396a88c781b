# SPDX-License-Identifier: Apache-2.0
"""What every process needs: parameters, executors, diagnostics, priorities, and how it begins and ends."""
