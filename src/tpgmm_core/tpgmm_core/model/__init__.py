# SPDX-License-Identifier: Apache-2.0
"""What a fitted model is used with: demonstrations, frames of a moment, adaptation to new frames, references."""
