// SPDX-License-Identifier: Apache-2.0
// Writes packets of Velodyne's VLP-16, VLP-32C, HDL-32E and VLS-128 (manuals 63-9243,
// 63-9325, 63-9113 and 63-9483). A packet consists of 12 blocks, the microseconds since
// the full hour (4 bytes), the return mode and the product number.
#include "base/bytes.hpp"
#include "read/packets/packet_format.hpp"

namespace relidar::packets {
namespace {

constexpr std::uint8_t kModeStrongest = 0x37, kModeDual = 0x39;
constexpr std::int64_t kNsPerHour = 3'600'000'000'000;

struct VelodyneProduct {
    const char* sensor;
    std::uint8_t code;
};
constexpr VelodyneProduct kVelodyneProducts[] = {
    {"VLP-16", 0x22}, {"VLP-32C", 0x28}, {"HDL-32E", 0x21}, {"VLS-128", 0xA1}};

class VelodyneFormat : public BlockWriter {
public:
    VelodyneFormat(const VelodyneProduct& product, const SpinningSensor& sensor, const PacketOptions& options)
        : BlockWriter(find_layout(product.sensor), sensor, options), code_(product.code) {}

    SensorPacket encode_packet(std::span<const FiringColumn> columns, std::uint32_t number) const override {
        SensorPacket packet{packet_time_ns(columns, number, &FiringColumn::time_s), {}};
        const std::int64_t clock_ns = packet_time_ns(columns, number, &FiringColumn::clock_s);
        append_blocks(packet.bytes, columns, number, layout().range_unit_m);
        append_raw(packet.bytes, std::uint32_t((clock_ns + 500) % kNsPerHour / 1000));
        append_raw(packet.bytes, is_dual() ? kModeDual : kModeStrongest);
        append_raw(packet.bytes, code_);
        return packet;
    }

private:
    std::uint8_t code_;
};

}  // namespace

std::vector<std::string> velodyne_names() {
    std::vector<std::string> names;
    for (const VelodyneProduct& product : kVelodyneProducts) names.emplace_back(product.sensor);
    return names;
}

std::unique_ptr<PacketFormat> make_velodyne(const SpinningSensor& sensor, const PacketOptions& options) {
    for (const VelodyneProduct& product : kVelodyneProducts)
        if (sensor.name == product.sensor) return std::make_unique<VelodyneFormat>(product, sensor, options);
    return nullptr;
}

}  // namespace relidar::packets
