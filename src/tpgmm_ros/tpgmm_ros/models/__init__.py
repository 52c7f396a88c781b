# SPDX-License-Identifier: Apache-2.0
"""Models of a task: learned from its recordings, held against its task file, judged by leave-one-out."""
