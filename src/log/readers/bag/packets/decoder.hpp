// SPDX-License-Identifier: Apache-2.0
// Packets of spinning LiDARs, a decoder a product behind one interface. Every firing is
// in them, so rays that were dropped are known. products.cpp has the list;
// block_decoder.cpp is Velodyne's and Hesai's, ouster_decoder.cpp Ouster's.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar::packets {

/// A packet as it was received.
struct PacketView {
    std::int64_t stamp_ns = 0;
    std::string_view bytes;
};

/// What a beam measured.
struct Echo {
    float range_m = 0.0f;    ///< from where the beam starts; 0: nothing
    float intensity = 0.0f;  ///< 0..1
};

/// All beams fired once.
struct Firing {
    int slot = 0;           ///< its place in the packet; one that was not fired is left out
    double after_us = 0.0;  ///< of the first beam, from the packet's own time
    /// of the head at the first beam, clockwise from the sensor's x axis, in [0, 360)
    double azimuth_deg = 0.0;
};

struct Packet {
    std::int64_t clock_ns = 0;  ///< of the sensor, when the packet was; begins again after Timing::wrap_us
    int n_slots = 0;            ///< firings of such a packet
    std::vector<Firing> firings;
    /// [firings x rings] returns of each ray in the packet's order
    std::vector<std::array<Echo, 2>> echoes;
};

/// What does not change from packet to packet.
struct Timing {
    double cycle_us = 0.0;          ///< from firing to firing
    double wrap_us = 0.0;           ///< 0: the sensor's clock goes on
    std::vector<double> offset_us;  ///< [rings] when a beam fires in its cycle
    /// the head is where the azimuths around tell it when a beam fires; else it turns
    /// evenly
    bool interpolates = false;
    /// [columns of a turn] of a sensor that fires at fixed azimuths, from 180 degrees on,
    /// and whose clock alone tells when: whether it fires there. Empty: it fires wherever
    /// its head is, and each packet's stamp tells when.
    std::vector<bool> fires = {};
    bool is_wide = false;  ///< intensities may go beyond 1: what counts as 1 is found from all of them
};

class Decoder {
public:
    virtual ~Decoder() = default;
    /// Of every packet that find_product() says is this product's. @throws DataError
    virtual Packet decode(std::string_view bytes) const = 0;
    virtual const Timing& timing() const = 0;
    /// The sensor as it turns, rings the highest first. @param columns  of a turn
    virtual SpinningSensor sensor(int columns, double rate_hz) const = 0;
    virtual std::string about() const = 0;  ///< product, and where its angles are from
};

struct OusterFormat;

/// What is known of a sensor beside its packets.
struct Calibration {
    std::string correction = {};  ///< Hesai's angle correction, as text; may be empty
    /// of its metadata; null: it is none, or its metadata is not there
    std::shared_ptr<const OusterFormat> ouster = {};
};

/// A kind of packet that is known.
struct Product {
    const char* name;
    bool (*is)(std::string_view bytes);  ///< by size and head; null: an Ouster's, which have none
    /// Makes nothing where packets of the product are not decoded. @throws DataError for
    /// a calibration that is damaged or of another sensor
    std::unique_ptr<Decoder> (*make)(const char* name, const Calibration& calibration);
    const char* driver = "";  ///< that makes clouds of those that are not decoded
};
/// By size and head, of an Ouster by the size that its metadata says. @return nullptr for
/// bytes that are no known packet
const Product* find_product(std::string_view bytes, const Calibration& calibration);
/// "packets of a VLS-128, expected those of ...": what to do about a packet that is not
/// decoded
std::string unknown_text(const Product* product, std::string_view bytes);

/// The makers of decoders: of Velodyne's and Hesai's products, of Ouster's.
std::unique_ptr<Decoder> make_block_decoder(const char* name, const Calibration& calibration);
std::unique_ptr<Decoder> make_ouster_decoder(const char* name, const Calibration& calibration);

}  // namespace relidar::packets
