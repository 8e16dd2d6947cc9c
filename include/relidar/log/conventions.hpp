// SPDX-License-Identifier: Apache-2.0
// Conventions: how the numbers of a recording are meant. Recordings often do not say it.
#pragma once

#include <string>

namespace relidar {

/// What the user knows about the numbers of a recording. Values that are `automatic` are
/// taken from the recording, or guessed. Log::conventions_used has what was used.
struct Conventions {
    /// Points at their firing times, or motion-compensated to one time.
    enum class Deskew { automatic, raw, deskewed };
    enum class TimeUnit { automatic, s, ms, us, ns };
    /// When the time of a point is 0: at the time stamp of its scan, at the zero of the
    /// clock of the stamps, or unknown, so that the first point gets the stamp.
    enum class TimeZero { automatic, stamp, clock, first_point };
    /// What pose files and messages contain. `sensor_from_world` is the inverse.
    enum class Poses { automatic, world_from_sensor, sensor_from_world };
    enum class Quaternions { automatic, wxyz, xyzw };
    enum class Angles { automatic, radians, degrees };  ///< roll, pitch and yaw of poses
    enum class Rings { automatic, highest_first, lowest_first };
    enum class BoxOrigin { automatic, centre, bottom };
    /// How boxes differ from x forward, y left: `swapped` has width before length,
    /// `turned` needs 90 degrees more yaw, `mirrored` has y and yaw of a left-handed
    /// frame.
    enum class BoxAxes { automatic, right, swapped, turned, mirrored_world, mirrored_vehicle };

    Deskew deskew = Deskew::automatic;
    TimeUnit time_unit = TimeUnit::automatic;  ///< of the times of points
    TimeZero time_zero = TimeZero::automatic;
    /// Seconds by which the clock of the scans is ahead of that of the poses, or "auto".
    std::string clock_offset_s = "auto";
    double intensity_max = 0.0;  ///< intensity that becomes 1; 0: automatic
    Poses poses = Poses::automatic;
    Quaternions quaternions = Quaternions::automatic;
    Angles angles = Angles::automatic;
    Rings rings = Rings::automatic;  ///< which beam has ring 0
    BoxOrigin box_origin = BoxOrigin::automatic;
    BoxAxes box_axes = BoxAxes::automatic;

    bool operator==(const Conventions&) const = default;
};

/// A convention with which a log was read: a row in the table of `relidar info`.
struct UsedConvention {
    std::string name, value;
    std::string from;     ///< why: kFromSetting, a field, or "guess: " and the reason
    std::string setting;  ///< key of the setting that changes it
    bool operator==(const UsedConvention&) const = default;
};
inline constexpr const char* kFromSetting = "setting";

}  // namespace relidar
