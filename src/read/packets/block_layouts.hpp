// SPDX-License-Identifier: Apache-2.0
// Tables of the products whose packets consist of blocks. They contain byte offsets of
// the fields in a packet, timing, and firing times of the lasers. block_decoder.cpp
// explains the format.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

namespace relidar::packets {

using namespace std::string_view_literals;

/// [lasers] time in nanoseconds from the start of a block until each laser fires; -1 if
/// the laser does not fire in this block
using LaserFiringTimes = std::array<std::int32_t, 128>;

// Firing times of the lasers of the Hesai QT128. The sensor alternates between two firing
// sequences, kQt128Loop1 and kQt128Loop2. Lasers 65 to 128 fire in both. Values from
// Hesai's manual, as used in tier4/nebula (commit 606ac41f1f13).
inline constexpr LaserFiringTimes kQt128Loop1 = {
    -1,     -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,
    -1,     -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,
    -1,     -1,    27656, 53000, 2312,  78344, 81512, 5480,  56168, 30824, 33992, 59336, 8648,  84680, 87848,
    11816,  62504, 37160, 40328, 65672, 14984, 91016, 94184, 18152, 68840, 43496, 46664, 72008, 21320, 97352,
    100520, 24488, 75176, 49832, 1456,  77488, 26800, 52144, 55312, 29968, 80656, 4624,  7792,  83824, 33136,
    58480,  61648, 36304, 86992, 10960, 14128, 90160, 39472, 64816, 67984, 42640, 93328, 17296, 20464, 96496,
    45808,  71152, 74320, 48976, 99664, 23632, 25944, 51288, 600,   76632, 79800, 3768,  54456, 29112, 32280,
    57624,  6936,  82968, 86136, 10104, 60792, 35448, 38616, 63960, 13272, 89304, 92472, 16440, 67128, 41784,
    44952,  70296, 19608, 95640, 98808, 22776, 73464, 48120};

inline constexpr LaserFiringTimes kQt128Loop2 = {
    2312,   78344, 27656, 53000, 56168, 30824, 81512, 5480,  8648,  84680, 33992, 59336, 62504, 37160, 87848,
    11816,  14984, 91016, 40328, 65672, 68840, 43496, 94184, 18152, 21320, 97352, 46664, 72008, 75176, 49832,
    100520, 24488, -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,
    -1,     -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,    -1,
    -1,     -1,    -1,    -1,    600,   76632, 25944, 51288, 54456, 29112, 79800, 3768,  6936,  82968, 32280,
    57624,  60792, 35448, 86136, 10104, 13272, 89304, 38616, 63960, 67128, 41784, 92472, 16440, 19608, 95640,
    44952,  70296, 73464, 48120, 98808, 22776, 26800, 52144, 1456,  77488, 80656, 4624,  55312, 29968, 33136,
    58480,  7792,  83824, 86992, 10960, 61648, 36304, 39472, 64816, 14128, 90160, 93328, 17296, 67984, 42640,
    45808,  71152, 20464, 96496, 99664, 23632, 74320, 48976};
inline constexpr LaserFiringTimes kQt128Loops[] = {kQt128Loop1, kQt128Loop2};

// Firing times of the OT128. In standard mode, all lasers fire in each block. In
// high-resolution mode, the sensor alternates between two firing sequences. The values
// are from Hesai's manual, as in tier4/nebula 606ac41f1f13.
inline constexpr LaserFiringTimes kOt128All = {
    49758, 43224, 36690, 30156, 21980, 15446, 8912,  2378,  49758, 43224, 36690, 30156, 2378,  15446, 8912,
    21980, 43224, 30156, 49758, 15446, 36690, 2378,  21980, 8912,  34312, 45002, 38468, 40846, 40846, 34312,
    51536, 47380, 31934, 47380, 31934, 51536, 38468, 27778, 27778, 45002, 38468, 40846, 51536, 45002, 31934,
    47380, 34312, 27778, 38468, 40846, 51536, 45002, 31934, 34312, 27778, 38468, 40846, 51536, 45002, 31934,
    47380, 34312, 27778, 45002, 45002, 51536, 38468, 40846, 47380, 40846, 31934, 45002, 27778, 38468, 40846,
    31934, 27778, 38468, 34312, 34312, 34312, 47380, 51536, 31934, 51536, 47380, 27778, 49758, 21980, 43224,
    15446, 43224, 36690, 8912,  30156, 2378,  49758, 21980, 36690, 15446, 8912,  30156, 2378,  49758, 43224,
    36690, 30156, 21980, 15446, 8912,  2378,  43224, 49758, 30156, 36690, 21980, 15446, 2378,  8912,  49758,
    43224, 36690, 30156, 21980, 15446, 8912,  2378,  30156};

inline constexpr LaserFiringTimes kOt128State0 = {
    -1,    -1,    -1,    -1,    21980, 15446, 8912,  2378,  -1,    -1,    -1,    -1,    2378,  15446, 8912,
    21980, -1,    2378,  21980, 8912,  6534,  17224, 10690, 13068, 13068, 6534,  23758, 19602, 4156,  19602,
    4156,  23758, 13068, 13068, 23758, 10690, 4156,  19602, 19602, 0,     10690, 6534,  23758, 17224, 23758,
    19602, 6534,  17224, 4156,  0,     6534,  0,     17224, 10690, 17224, 17224, 23758, 23758, 10690, 13068,
    13068, 13068, 19602, 19602, 6534,  13068, 4156,  4156,  17224, 17224, 17224, 0,     10690, 10690, 13068,
    13068, 4156,  0,     10690, 6534,  6534,  6534,  19602, 23758, 4156,  23758, 19602, 0,     -1,    21980,
    -1,    15446, -1,    8912,  -1,    2378,  -1,    -1,    21980, -1,    15446, 8912,  -1,    2378,  -1,
    -1,    -1,    -1,    21980, 15446, 8912,  2378,  -1,    -1,    -1,    -1,    21980, 15446, 2378,  8912,
    -1,    -1,    -1,    -1,    21980, 15446, 8912,  2378};

inline constexpr LaserFiringTimes kOt128State1 = {
    21980, 15446, 8912,  2378,  -1,    -1,    -1,    -1,    21980, 15446, 8912,  2378,  -1,    -1,    -1,
    -1,    8912,  -1,    -1,    -1,    6534,  17224, 10690, 13068, 13068, 6534,  23758, 19602, 4156,  19602,
    4156,  23758, 13068, 13068, 23758, 10690, 4156,  19602, 19602, 0,     10690, 6534,  23758, 17224, 23758,
    19602, 6534,  17224, 4156,  0,     6534,  0,     17224, 10690, 17224, 17224, 23758, 23758, 10690, 13068,
    13068, 13068, 19602, 19602, 6534,  13068, 4156,  4156,  17224, 17224, 17224, 0,     10690, 10690, 13068,
    13068, 4156,  0,     10690, 6534,  6534,  6534,  19602, 23758, 4156,  23758, 19602, 0,     21980, -1,
    15446, -1,    8912,  -1,    2378,  -1,    21980, 15446, -1,    8912,  -1,    -1,    2378,  -1,    21980,
    15446, 8912,  2378,  -1,    -1,    -1,    -1,    15446, 21980, 2378,  8912,  -1,    -1,    -1,    -1,
    21980, 15446, 8912,  2378,  -1,    -1,    -1,    -1};
inline constexpr LaserFiringTimes kOt128Standard[] = {kOt128All};
inline constexpr LaserFiringTimes kOt128States[] = {kOt128State0, kOt128State1};

/// Where a packet stores which of two sets of lasers has fired.
enum class FiringSequenceRule {
    none,           ///< no field, because all blocks have the same firing sequence
    mode_flag,      ///< number of the block; for packets with two returns, bit 0 of a byte
    azimuth_state,  ///< two bits for each block, starting with the highest bits of two bytes
};

/// Format of a product's packets.
struct PacketLayout {
    const char* name;
    const char* sensor;  ///< name of the built-in sensor that defines the beam angles
    std::size_t blocks_at = 0, n_blocks = 12;
    bool flagged = false;   ///< true if two bytes precede the azimuth of each block
    std::size_t banks = 1;  ///< blocks per firing and return
    /// lasers per block, and bytes per laser (range and reflectivity)
    std::size_t block_lasers = 32, unit_bytes = 3;
    std::size_t firings = 1;        ///< firings per block
    std::size_t block_returns = 1;  ///< returns of the same firing in a block
    /// Unit of the ranges in metres. If 0, byte `unit_at` of the packet contains the unit
    /// in millimetres.
    double range_unit_m = 0.0;
    std::size_t unit_at = 9, time_at = 0;
    std::size_t mode_at = 0;  ///< byte offset of the return mode; 0 if all packets have one return
    /// True if numbers are stored with the highest byte first. In such packets, a time is
    /// stored as two numbers: milliseconds and microseconds.
    bool is_big_endian = false;
    double wrap_us = 1e6, cycle_us = 50.0;
    /// true if the time stamp of a packet refers to its last firing, false if to its
    /// first
    bool at_end = true;
    /// time from the packet's time stamp to the start of this firing
    double shift_us = 0.0;
    double forward_deg = 90.0;        ///< azimuth of the sensor's x axis in the angles of the packet
    int first_channel = 1;            ///< number of the first channel in the beam table
    bool has_correction_file = true;  ///< true if each unit has a file with its beam angles
    /// Range values up to this one mean "no return".
    std::uint16_t last_marker = 0;
    /// [firing sequences] firing times of the lasers. Empty if the table of built-in
    /// sensors contains them.
    std::span<const LaserFiringTimes> sequences = {};
    FiringSequenceRule sequence_rule = FiringSequenceRule::none;
    std::size_t sequence_at = 0;  ///< byte offset of the field that contains the firing sequence

    std::size_t n_lasers() const { return block_lasers * banks; }
    std::size_t n_sequences() const { return sequences.empty() ? 1 : sequences.size(); }
};

/// One laser in one firing sequence. It measures one row of a scan.
struct PacketBeam {
    std::size_t laser = 0;     ///< index of the laser in a firing, from 0
    std::size_t sequence = 0;  ///< index of the firing sequence
    std::size_t line = 0;      ///< row of the laser in the beam table of the built-in sensor
    /// elevation from the sensor's angle correction file; 0 if the file is missing
    double elevation_deg = 0.0;
    /// time between the start of the first firing sequence and the firing of the laser
    double offset_us = 0.0;
};

/// Returns the beams (rows of a scan) of a sensor, in the order of its built-in beam
/// table. A laser that fires in two firing sequences has two beams.
std::vector<PacketBeam> list_beams(const PacketLayout& layout);

/// Velodyne: 12 blocks that begin with FF EE. A firing of the VLS-128 takes 55.3 us,
/// although its manual states 53.3 us.
constexpr PacketLayout velodyne_layout(const char* name, std::size_t block_lasers, std::size_t firings,
                                       std::size_t banks, double range_unit_m, double cycle_us,
                                       double shift_us) {
    PacketLayout layout{name, name};
    layout.flagged = true;
    layout.block_lasers = block_lasers;
    layout.firings = firings;
    layout.banks = banks;
    layout.range_unit_m = range_unit_m;
    layout.time_at = 1200;
    layout.mode_at = 1204;
    layout.wrap_us = 3.6e9;
    layout.cycle_us = cycle_us;
    layout.at_end = false;
    layout.shift_us = shift_us;
    layout.forward_deg = 0.0;
    layout.first_channel = 0;
    layout.has_correction_file = false;
    return layout;
}

/// RoboSense: blocks like Velodyne's, but other byte order, clock and byte offsets.
constexpr PacketLayout rs16_layout(const char* name, std::size_t firings, std::size_t block_returns) {
    // 16 lasers, 1 bank, range unit 5 mm, 55.5 us per firing, no time shift
    PacketLayout layout = velodyne_layout("RS-LiDAR-16", 16, firings, 1, 0.005, 55.5, 0.0);
    layout.name = name;
    layout.blocks_at = 42;
    layout.block_returns = block_returns;
    layout.time_at = 26;
    layout.mode_at = 0;
    layout.is_big_endian = true;
    layout.wrap_us = 1e6;
    layout.first_channel = 1;
    return layout;
}

/// Hesai's manuals state the time of each laser relative to the start of its block. In
/// relidar, the first laser of a firing has the time 0. So `shift_us` is the sum of the
/// start of the block and the time of its first laser.
constexpr PacketLayout hesai_layout(const char* name, std::size_t blocks_at, std::size_t n_blocks,
                                    std::size_t block_lasers, std::size_t unit_bytes, std::size_t time_at,
                                    std::size_t mode_at, double cycle_us, double shift_us) {
    PacketLayout layout{name, name, blocks_at, n_blocks};
    layout.block_lasers = block_lasers;
    layout.unit_bytes = unit_bytes;
    layout.time_at = time_at;
    layout.mode_at = mode_at;
    layout.cycle_us = cycle_us;
    layout.shift_us = shift_us;
    return layout;
}

constexpr PacketLayout pandar40p_layout() {
    PacketLayout layout = hesai_layout("Pandar40P", 0, 10, 40, 3, 1250, 1254, 55.56, -28.58 - 54.67);
    layout.flagged = true;
    layout.range_unit_m = 0.004;
    return layout;
}

constexpr PacketLayout pandar64_layout() {
    PacketLayout layout = hesai_layout("Pandar64", 8, 6, 64, 3, 1182, 1186, 55.56, -42.58 - 54.668);
    layout.unit_at = 5;
    return layout;
}

constexpr PacketLayout qt64_layout() {
    PacketLayout layout = hesai_layout("QT64", 12, 4, 64, 4, 1056, 1060, 500.0 / 3.0, 25.71 + 12.31);
    layout.at_end = false;
    return layout;
}

constexpr PacketLayout qt128_layout() {
    PacketLayout layout = hesai_layout("QT128", 12, 2, 128, 4, 1082, 1073, 1000.0 / 9.0, 9.0 + 0.6);
    layout.sequences = kQt128Loops;
    layout.sequence_rule = FiringSequenceRule::mode_flag;
    layout.sequence_at = 1066;
    return layout;
}

constexpr PacketLayout ot128_layout(bool is_fine) {
    // 2 blocks from byte 12, each with 128 lasers of 3 bytes; time at byte 826, return
    // mode at byte 817, time of a firing, time shift
    PacketLayout layout =
        hesai_layout("OT128", 12, 2, 128, 3, 826, 817, (is_fine ? 250.0 : 500.0) / 9.0, 43.346);
    layout.last_marker = 3;
    if (is_fine) {
        layout.name = "OT128 in high resolution";
        layout.sequences = kOt128States;
        layout.sequence_rule = FiringSequenceRule::azimuth_state;
        layout.sequence_at = 814;
    } else {
        // In this mode, the first laser fires 2.378 us after the start of its block.
        layout.shift_us = 43.346 + 2.378;
        layout.sequences = kOt128Standard;
    }
    return layout;
}

inline constexpr PacketLayout kLayouts[] = {
    velodyne_layout("VLP-16", 16, 2, 1, 0.002, 55.296, 0.0),
    velodyne_layout("VLP-32C", 32, 1, 1, 0.004, 55.296, 0.0),
    velodyne_layout("HDL-32E", 32, 1, 1, 0.002, 46.08, 0.0),
    velodyne_layout("VLS-128", 32, 1, 4, 0.004, 55.296, -8.7),
    rs16_layout("RS-LiDAR-16", 2, 1),
    rs16_layout("RS-LiDAR-16 with two returns", 1, 2),
    pandar40p_layout(),
    pandar64_layout(),
    hesai_layout("XT32", 12, 8, 32, 4, 1071, 1062, 50.0, 5.632 + 0.368),
    hesai_layout("XT16", 12, 8, 16, 4, 559, 550, 50.0, 5.632 + 0.368),
    hesai_layout("XT32M", 12, 6, 32, 4, 811, 802, 50.0, 5.632 + 0.368),
    qt64_layout(),
    qt128_layout(),
    ot128_layout(false),
    ot128_layout(true),
};

// What the encoder writes around the blocks: the product number of Velodyne, and the
// header and the tail of Hesai's packets.

struct VelodyneProduct {
    const char* sensor;
    std::uint8_t code;
};
inline constexpr VelodyneProduct kVelodyneProducts[] = {
    {"VLP-16", 0x22}, {"VLP-32C", 0x28}, {"HDL-32E", 0x21}, {"VLS-128", 0xA1}};

struct HesaiProduct {
    const char* layout;  ///< name in the table kLayouts
    std::string_view header;
    std::size_t reserved;  ///< number of bytes between the blocks and the motor speed or return mode
    /// If true, the return mode is stored before the motor speed, and the date before the
    /// time.
    bool is_mode_first;
    int first_year;  ///< year from which the date is counted
    /// If true, a safety field and a checksum follow the blocks, and a second checksum
    /// ends the packet.
    bool has_checksums = false;
    std::uint8_t operation_mode = 0;  ///< byte before the return mode, if `is_mode_first`
    std::size_t motion_bytes = 0;     ///< size of the motion data after the packet number
};
// One row per product: the header of a packet and the fields after the blocks. A header
// of 12 bytes stores the protocol version, the numbers of lasers and blocks, and the
// position of the last return. Then it stores the unit in millimetres, the number of
// returns, and flags for the optional fields: 1 packet number, 2 motion data, 4 safety
// field.
inline constexpr std::string_view kOt128Header = "\xEE\xFF\x01\x04\0\0\x80\x02\0\x04\x01\x07"sv;
inline constexpr HesaiProduct kHesaiProducts[] = {
    {"Pandar40P", "", 8, false, 2000},
    {"Pandar64", "\xEE\xFF\x40\x06\0\x04\0\0"sv, 8, false, 2000},
    {"XT32", "\xEE\xFF\x06\x01\0\0\x20\x08\0\x04\x01\x01"sv, 10, true, 1900},
    {"XT16", "\xEE\xFF\x06\x01\0\0\x10\x08\0\x04\x01\x01"sv, 10, true, 1900},
    {"XT32M", "\xEE\xFF\x06\x01\0\0\x20\x06\0\x04\x01\x01"sv, 10, true, 1900},
    {"QT64", "\xEE\xFF\x03\x01\0\0\x40\x04\0\x04\x01\x01"sv, 10, false, 1900},
    {"QT128", "\xEE\xFF\x03\x02\0\0\x80\x02\0\x04\x01\x05"sv, 12, true, 1900, true},
    {"OT128", kOt128Header, 12, true, 1900, true, 1, 22},
    {"OT128 in high resolution", kOt128Header, 12, true, 1900, true, 0, 22},
};

}  // namespace relidar::packets
