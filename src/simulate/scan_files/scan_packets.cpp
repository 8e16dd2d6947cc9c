// SPDX-License-Identifier: Apache-2.0
#include <relidar/simulate/scan_packets.hpp>

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

Scan convert_rendered_to_measured_scan(const RenderedScan& scan, const Config& config) {
    const RangeImage& image = scan.image;
    Scan measured;
    measured.rays.rows = image.rows;
    measured.rays.columns = image.columns;
    measured.rays.origin = to_scan_array(image.origin);
    measured.rays.direction = to_scan_array(image.direction);
    measured.rays.time_offset_s = to_scan_array(scan.time_offset_s);
    measured.rays.channel = to_scan_array(scan.ring);
    measured.range_m = to_scan_array(select_point_ranges(scan, config));
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
    bool has_started = false;

    /// Creates one packet encoder per sensor.
    /// @param time_shift_s  offset in whole seconds that makes all times positive
    void create_packet_encoders(double time_shift_s) {
        encoders.clear();
        for (const ScanOutputOptions& format : sensors) {
            PacketOptions options;
            options.start_ns = format.packets.log_start_ns + std::llround(1e9 * time_shift_s);
            options.returns = format.config.sensor.returns;
            options.ouster_profile = format.packets.ouster_profile;
            encoders.push_back(std::make_unique<PacketEncoder>(*format.packets.sensor, options));
        }
    }
};

ScanPacketEncoder::ScanPacketEncoder(std::vector<ScanOutputOptions> sensors)
    : impl_(std::make_unique<Impl>()) {
    for (const ScanOutputOptions& format : sensors)
        if (!format.packets.sensor)
            throw UsageError(fmt::format("cannot write packets of the sensor \"{}\", expected one of {}",
                                         format.sensor, format_packet_sensor_names()));
    impl_->sensors = std::move(sensors);
    impl_->create_packet_encoders(0.0);
}

ScanPacketEncoder::~ScanPacketEncoder() = default;

std::vector<std::vector<SensorPacket>> ScanPacketEncoder::encode_scans_as_packets(
    std::span<const RenderedScan> scans) {
    if (scans.size() != impl_->encoders.size())
        throw UsageError(fmt::format("cannot write packets: found {} scans, expected {}, one of each sensor",
                                     scans.size(), impl_->encoders.size()));
    if (!std::exchange(impl_->has_started, true)) {
        double first_s = 0.0;
        for (const RenderedScan& scan : scans) first_s = std::min(first_s, scan.time_s);
        // If the log starts at time 0, shifts all times so that they are positive. The
        // extra second covers rays that fire before the time of their scan.
        if (impl_->sensors.front().packets.log_start_ns == 0)
            impl_->create_packet_encoders(1.0 + std::ceil(-first_s));
    }
    std::vector<std::vector<SensorPacket>> packets;
    for (std::size_t s = 0; s < scans.size(); ++s)
        packets.push_back(impl_->encoders[s]->encode_scan_as_packets(
            convert_rendered_to_measured_scan(scans[s], impl_->sensors[s].config), scans[s].time_s));
    return packets;
}

std::vector<std::vector<SensorPacket>> ScanPacketEncoder::flush_remaining_packets() {
    std::vector<std::vector<SensorPacket>> packets;
    for (const auto& encoder : impl_->encoders) packets.push_back(encoder->flush_remaining_packets());
    return packets;
}

const PacketEncoder& ScanPacketEncoder::get_packet_encoder(std::size_t sensor_index) const {
    return *impl_->encoders[sensor_index];
}

}  // namespace relidar
