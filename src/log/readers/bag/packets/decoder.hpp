// SPDX-License-Identifier: Apache-2.0
// Interface of the packet decoders of spinning LiDARs. Packets contain every firing, so
// rays without a return (dropped rays) are known. products.cpp lists the supported
// products. block_decoder.cpp decodes Velodyne and Hesai, ouster_decoder.cpp decodes
// Ouster.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/sensor.hpp>

#include "log/readers/bag/packets/correction.hpp"

namespace relidar::packets {

/// A packet as it was received.
struct PacketView {
    std::int64_t stamp_ns = 0;
    std::string_view bytes;
};

/// One return that a beam has measured.
struct Echo {
    float range_m = 0.0f;    ///< relative to the beam's origin; 0: no return
    float intensity = 0.0f;  ///< intensity from 0 to 1
};

/// One firing of all beams.
struct Firing {
    int slot = 0;  ///< index of the firing in the packet; firings that were not measured are left out
    double after_us = 0.0;  ///< time from the packet's time to the firing of the first beam
    /// Azimuth of the head when the first beam fires, clockwise from the sensor's x axis,
    /// in [0, 360).
    double azimuth_deg = 0.0;
    int part = 0;  ///< index of the firing sequence, see Timing::parts
};

struct Packet {
    /// packet time on the sensor's clock, which restarts at 0 after Timing::wrap_us
    std::int64_t clock_ns = 0;
    int n_slots = 0;  ///< firings per packet
    std::vector<Firing> firings;
    /// [firings x rings] first and second return of each ray, in the order of the packet
    std::vector<std::array<Echo, 2>> echoes;
};

/// Timing constants of a sensor's packets.
struct Timing {
    double cycle_us = 0.0;  ///< time between firings
    /// Number of firing sequences between which the sensor alternates. The firings of all
    /// sequences form one column of the scan. Each sequence has its own beams.
    int parts = 1;
    double wrap_us = 0.0;  ///< time after which the sensor's clock restarts at 0; 0: it never restarts
    /// [rings] time of each beam within a firing; with several firing sequences, time
    /// since the start of the first of them
    std::vector<double> offset_us;
    /// True: the head angle at a beam is interpolated between the azimuths of
    /// neighbouring firings. False: the head is assumed to rotate at a constant rate.
    bool interpolates = false;
    /// [columns per revolution] true if the sensor fires at this column. Column 0 is at
    /// 180 degrees. Such a sensor fires at fixed azimuths, and its own clock defines all
    /// times. Empty: the sensor fires at any azimuth, and the stamps of the packets
    /// define the times.
    std::vector<bool> fires = {};
    /// True: intensities may exceed 1. The intensity that is scaled to 1 is then
    /// estimated from all intensities of the topic.
    bool is_wide = false;
};

class Decoder {
public:
    virtual ~Decoder() = default;
    /// Decodes a packet of this decoder's product.
    /// @throws DataError if the packet is invalid
    virtual Packet decode(std::string_view bytes) const = 0;
    virtual const Timing& timing() const = 0;
    /// Returns the model of the spinning sensor. Its beams are sorted with the highest
    /// ring first.
    /// @param columns  columns per revolution
    virtual SpinningSensor sensor(int columns, double rate_hz) const = 0;
    virtual std::string about() const = 0;  ///< product and source of its angles
};

struct OusterFormat;

/// Calibration data that the packets of a sensor do not contain.
struct Calibration {
    std::vector<Correction> corrections = {};  ///< angle corrections of Hesai's sensors
    /// Packet format from the metadata of an Ouster. Null if the sensor is not an Ouster
    /// or its metadata is missing.
    std::shared_ptr<const OusterFormat> ouster = {};
};

/// A product whose packets relidar recognises.
struct Product {
    const char* name;
    /// Returns true if a packet has the size and header of this product. Null for Ouster,
    /// because its packets have no identification.
    bool (*is)(std::string_view bytes);
    /// Creates a decoder. Returns null if relidar cannot decode packets of this product.
    /// @throws DataError if a calibration is damaged or belongs to another sensor
    std::unique_ptr<Decoder> (*make)(const char* name, const Calibration& calibration);
    const char* driver = "";  ///< name of the driver that the user can run if relidar has no decoder
};
/// Finds the product of a packet by the packet's size and header. An Ouster packet is
/// recognised by the packet size in the metadata.
/// @return null if no product matches
const Product* find_product(std::string_view bytes, const Calibration& calibration);
/// Returns an error text for a packet that relidar cannot decode. Example: "packets of a
/// VLS-128, expected those of ...".
std::string unknown_text(const Product* product, std::string_view bytes);

/// Create the decoders of Velodyne's and Hesai's products, and of Ouster's products.
std::unique_ptr<Decoder> make_block_decoder(const char* name, const Calibration& calibration);
std::unique_ptr<Decoder> make_ouster_decoder(const char* name, const Calibration& calibration);

}  // namespace relidar::packets
