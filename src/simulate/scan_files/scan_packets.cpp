// SPDX-License-Identifier: Apache-2.0
#include <relidar/simulate/scan_packets.hpp>

#include <map>

#include <relidar/simulate/render.hpp>
#include "base/fail.hpp"
#include "simulate/scan_files/recorded_moment.hpp"

namespace relidar {

Scan to_measured(const RenderedScan& scan, const Config& config) {
    const RangeImage& image = scan.image;
    Scan measured;
    measured.rays.rows = image.rows;
    measured.rays.columns = image.columns;
    measured.rays.origin = to_scan_array(image.origin);
    measured.rays.direction = to_scan_array(image.direction);
    measured.rays.time_offset_s = to_scan_array(scan.time_offset_s);
    measured.rays.channel = to_scan_array(scan.ring);
    measured.range_m = to_scan_array(point_ranges(scan, config));
    measured.intensity = to_scan_array(image.intensity);
    measured.second_returns = scan.second_returns;
    for (std::size_t i = 0; i < measured.range_m.size(); ++i) {
        if (is_ray_returned(image.drop_prob[i], measured.range_m[i])) continue;
        measured.range_m[i] = 0.0f;
        measured.intensity[i] = 0.0f;
        for (AdditionalReturns& second : measured.second_returns) second.range_m[i] = 0.0f;
    }
    return measured;
}

struct ScanPacketEncoder::Impl {
    std::vector<ScanOutputOptions> sensors;
    std::vector<std::unique_ptr<PacketEncoder>> encoders;
};

ScanPacketEncoder::ScanPacketEncoder(std::vector<ScanOutputOptions> sensors)
    : impl_(std::make_unique<Impl>()) {
    // Each sensor needs other UDP ports. Ouster uses other ports than all others.
    std::map<bool, int> n_units;  // by whether the sensor is an Ouster
    for (const ScanOutputOptions& format : sensors) {
        if (!format.packets.sensor)
            fail<UsageError>("cannot write packets of the sensor \"{}\", expected one of {}", format.sensor,
                             packet_sensors());
        const PacketOptions options{.start_ns = format.time_shift_ns,
                                    .returns = format.config.sensor.returns,
                                    .ouster_profile = format.packets.ouster_profile,
                                    .unit = n_units[packet_maker(format.packets.sensor->name) == "Ouster"]++};
        impl_->encoders.push_back(std::make_unique<PacketEncoder>(*format.packets.sensor, options));
    }
    impl_->sensors = std::move(sensors);
}

ScanPacketEncoder::~ScanPacketEncoder() = default;

std::vector<std::vector<SensorPacket>> ScanPacketEncoder::encode(std::span<const RenderedScan> scans) {
    if (scans.size() != impl_->encoders.size())
        fail<UsageError>("cannot write packets: found {} scans, expected {}, one of each sensor",
                         scans.size(), impl_->encoders.size());
    scan_files::check_times(scans, impl_->sensors.front().time_shift_ns);
    std::vector<std::vector<SensorPacket>> packets;
    for (std::size_t s = 0; s < scans.size(); ++s)
        packets.push_back(
            impl_->encoders[s]->add_scan(to_measured(scans[s], impl_->sensors[s].config), scans[s].time_s));
    return packets;
}

std::vector<std::vector<SensorPacket>> ScanPacketEncoder::flush() {
    std::vector<std::vector<SensorPacket>> packets;
    for (const auto& encoder : impl_->encoders) packets.push_back(encoder->flush());
    return packets;
}

const PacketEncoder& ScanPacketEncoder::encoder(std::size_t sensor) const { return *impl_->encoders[sensor]; }

}  // namespace relidar
