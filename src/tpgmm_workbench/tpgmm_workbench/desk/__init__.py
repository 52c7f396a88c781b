# SPDX-License-Identifier: Apache-2.0
"""What a user may ask of the workbench, and what comes of it; without a page. Nothing here waits."""
