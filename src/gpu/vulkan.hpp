// SPDX-License-Identifier: Apache-2.0
// Declares the functions and structs of Vulkan. Only the library includes this header,
// not its users.
#pragma once

#include <volk.h>

#if defined(__GNUC__)
// Vulkan structs are initialised with {sType} and then filled member by member.
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
#endif
