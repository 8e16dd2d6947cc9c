// SPDX-License-Identifier: Apache-2.0
// Writes the layout that OpenPCDet and mmdet3d document for custom data sets.
#include "simulate/scan_files/layouts/layout.hpp"

#include <fmt/format.h>

#include "base/codecs/npy.hpp"
#include "base/fail.hpp"

namespace relidar::layouts {
namespace {

namespace fs = std::filesystem;

class CustomWriter : public LayoutWriter {
public:
    CustomWriter(SequencePlace place, const std::vector<DatasetSensor>& sensors, const DatasetView& view)
        : LayoutWriter(std::move(place), sensors, view) {
        constexpr int kMaxNames = 1'000'000;  // names have 6 digits
        if (place_.first_frame + place_.n_frames > kMaxNames)
            fail<UsageError>("--layout custom: found frame {}, expected at most {}",
                             place_.first_frame + place_.n_frames - 1, kMaxNames - 1);
        if (!place_.is_new) return;
        // Removes the frames of an interrupted sequence.
        std::error_code failed;
        for (int frame = place_.first_frame; fs::remove(points_file(frame, "bin"), failed); ++frame) {
            fs::remove(points_file(frame, "npy"), failed);
            fs::remove(label_file(frame), failed);
        }
    }

    void write_frame(const LabelledFrame& frame) override {
        const int number = place_.first_frame + int(frame.index);
        // OpenPCDet reads only npy. mmdet3d reads the header of an npy file as points.
        const std::string points = pack_rig_points(frame, sensors_);
        const ArrayShape shape{points.size() / (4 * sizeof(float)), 4};
        write_bytes(points_file(number, "bin"), points);
        write_bytes(
            points_file(number, "npy"),
            codecs::make_npy_header({.name = "points", .dtype = "f4", .shape = shape, .bytes = {}}) + points);
        std::string labels;
        for (const LabelledObject& object : frame.objects) {
            const Pose box = inverse(frame.world_from_rig) * object.world_from_box;
            const glm::dvec3 &centre = box.translation, &size_m = object.size_m,
                             forward = box.rotation * glm::dvec3(1.0, 0.0, 0.0);
            labels += fmt::format("{:.4f} {:.4f} {:.4f} {:.4f} {:.4f} {:.4f} {:.4f} {}\n", centre.x, centre.y,
                                  centre.z, size_m.x, size_m.y, size_m.z, std::atan2(forward.y, forward.x),
                                  object.name);
        }
        write_bytes(label_file(number), labels);
    }

    void finish(const DatasetIndex& index) override {
        std::string train, val;
        int number = 0;
        for (std::size_t s = 0; s < index.sequences.size(); ++s)
            for (int frame = 0; frame < index.sequences[s].n_frames; ++frame, ++number) {
                // OpenPCDet fails on a frame without a box.
                std::error_code failed;
                if (fs::file_size(label_file(number), failed) == 0) continue;
                (index.is_validation(s, frame) ? val : train) += fmt::format("{:06}\n", number);
            }
        write_bytes(place_.folder / "ImageSets/train.txt", train);
        write_bytes(place_.folder / "ImageSets/val.txt", val);
    }

private:
    fs::path points_file(int number, const char* extension) const {
        return place_.folder / "points" / fmt::format("{:06}.{}", number, extension);
    }
    fs::path label_file(int number) const {
        return place_.folder / "labels" / fmt::format("{:06}.txt", number);
    }
};

}  // namespace

std::unique_ptr<LayoutWriter> make_custom_writer(SequencePlace place,
                                                 const std::vector<DatasetSensor>& sensors,
                                                 const DatasetView& view) {
    return std::make_unique<CustomWriter>(std::move(place), sensors, view);
}

}  // namespace relidar::layouts
