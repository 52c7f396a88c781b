# SPDX-License-Identifier: Apache-2.0
"""The running nodes as the workbench deals with them: what they say, what they are asked for, what is recorded."""
