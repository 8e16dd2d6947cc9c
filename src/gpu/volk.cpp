// SPDX-License-Identifier: Apache-2.0
// The one place where volk's implementation is compiled: the binary never links the
// Vulkan loader, so it starts without one and can say so.
#include <volk.c>
