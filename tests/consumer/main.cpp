// SPDX-License-Identifier: Apache-2.0
// Smallest program that uses the installed library. It creates a table of rays and lists
// the devices that could trace them.
#include <cstdio>

#include <relidar/base/error.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/log/sensor.hpp>

int main() {
    std::printf("%zu rays\n", relidar::make_rays(relidar::kitti360_grid()).size());
    try {
        for (const relidar::DeviceInfo& device : relidar::list_devices())
            std::printf("device %d: %s\n", device.index, device.name.c_str());
    } catch (const relidar::DeviceError& error) {
        std::printf("no device: %s\n", error.what());
    }
}
