// SPDX-License-Identifier: Apache-2.0
// The functions and structs of Vulkan. Private to the library.
#pragma once

#include <volk.h>

#if defined(__GNUC__)
// structs are filled member by member after {sType}
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
#endif
