# SPDX-License-Identifier: Apache-2.0
"""Messages: to arrays and back, how they are sent, and what they say when there is nothing to say."""
