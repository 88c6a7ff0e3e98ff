#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfRgbaFile.h>
#include <OpenEXR/ImfStringAttribute.h>

#include <algorithm>
#include <array>

#include "effigy/base/error.h"
#include "effigy/image/codecs.h"

namespace effigy {
namespace {

using Imath::Box2i;

// The channels to read, in order: R G B (A) R G, or Y (A) of the top layer, else of the first layer
// that has R G B, else the first channel alone.
std::vector<std::string> pick_channels(const Imf::ChannelList& channels) {
  const auto has = [&](const std::string& channel) {
    return channels.findChannel(channel.c_str()) != nullptr;
  };
  const auto with_alpha = [&](std::vector<std::string> names, const std::string& alpha) {
    if (has(alpha)) names.push_back(alpha);
    return names;
  };
  if (has("R") && has("G") && has("B")) return with_alpha({"R", "G", "B"}, "A");
  if (has("R") && has("G")) return {"R", "G"};
  if (has("Y") && has("A")) return {"Y", "Y", "Y", "A"};
  if (has("Y")) return {"Y"};
  std::string first;
  for (auto i = channels.begin(); i != channels.end(); ++i) {
    const std::string channel = i.name();
    if (first.empty()) first = channel;
    const size_t dot = channel.rfind('.');
    if (dot == std::string::npos || channel.substr(dot) != ".R") continue;
    const std::string layer = channel.substr(0, dot);
    if (has(layer + ".G") && has(layer + ".B"))
      return with_alpha({layer + ".R", layer + ".G", layer + ".B"}, layer + ".A");
  }
  if (first.empty()) return {};
  return {first};
}

int64_t side(int low, int high) {
  return int64_t{high} - low + 1;
}

// Luminance-chroma files: OpenEXR converts them to RGB.
Image read_luminance_chroma(const std::string& name, const Box2i& window) {
  Imf::RgbaInputFile file(name.c_str());
  Image image(static_cast<int>(side(window.min.x, window.max.x)),
              static_cast<int>(side(window.min.y, window.max.y)), 3);
  std::vector<Imf::Rgba> line(static_cast<size_t>(image.width));
  for (int y = 0; y < image.height; ++y) {
    const std::ptrdiff_t row = window.min.y + y;
    file.setFrameBuffer(line.data() - window.min.x - row * image.width, 1,
                        static_cast<size_t>(image.width));
    file.readPixels(static_cast<int>(row));
    for (int x = 0; x < image.width; ++x) {
      const Imf::Rgba& pixel = line[static_cast<size_t>(x)];
      float* out = image.at(x, y);
      out[0] = pixel.r, out[1] = pixel.g, out[2] = pixel.b;
    }
  }
  return image;
}

Image read_channels(Imf::InputFile& file, const std::vector<std::string>& names,
                    const Box2i& window) {
  Image image(static_cast<int>(side(window.min.x, window.max.x)),
              static_cast<int>(side(window.min.y, window.max.y)), static_cast<int>(names.size()));
  const size_t pixel = names.size() * sizeof(float);
  const size_t line = pixel * static_cast<size_t>(image.width);
  Imf::FrameBuffer frame;
  for (size_t c = 0; c < names.size(); ++c) {
    if (c > 0 && names[c] == names[0]) continue;
    char* origin = reinterpret_cast<char*>(image.data.data() + c);
    frame.insert(names[c], Imf::Slice::Make(Imf::FLOAT, origin, window, pixel, line));
  }
  file.setFrameBuffer(frame);
  file.readPixels(window.min.y, window.max.y);
  if (names.size() == 4 && names[1] == names[0])  // Y with alpha
    for (size_t i = 0; i < image.data.size(); i += 4)
      image.data[i + 1] = image.data[i + 2] = image.data[i];
  return image;
}

// The display window: what a viewer shows; pixels without data are 0.
Image place(Image image, const Box2i& data, const Box2i& display) {
  if (data == display) return image;
  Image result(static_cast<int>(side(display.min.x, display.max.x)),
               static_cast<int>(side(display.min.y, display.max.y)), image.channels);
  const int left = std::max(data.min.x, display.min.x), right = std::min(data.max.x, display.max.x);
  const int top = std::max(data.min.y, display.min.y);
  const int bottom = std::min(data.max.y, display.max.y);
  for (int y = top; y <= bottom && left <= right; ++y)
    std::copy_n(image.at(left - data.min.x, y - data.min.y),
                static_cast<size_t>(side(left, right)) * static_cast<size_t>(image.channels),
                result.at(left - display.min.x, y - display.min.y));
  return result;
}

}  // namespace

namespace detail {

Image read_exr(const Path& path) {
  const std::string name = path.string();
  try {
    Imf::InputFile file(name.c_str());
    const Box2i data = file.header().dataWindow(), display = file.header().displayWindow();
    check_picture_size(name, side(data.min.x, data.max.x), side(data.min.y, data.max.y),
                       kMaxFloatPixels);
    check_picture_size(name, side(display.min.x, display.max.x), side(display.min.y, display.max.y),
                       kMaxFloatPixels);
    const Imf::ChannelList& channels = file.header().channels();
    if (channels.findChannel("RY") != nullptr && channels.findChannel("BY") != nullptr)
      return place(read_luminance_chroma(name, data), data, display);
    const auto names = pick_channels(channels);
    if (names.empty()) fail_read(name, "it has no channels");
    for (const std::string& channel : names) {
      const Imf::Channel* found = channels.findChannel(channel.c_str());
      if (found->xSampling != 1 || found->ySampling != 1)
        fail_read(name, "its channel " + channel + " is subsampled");
    }
    return place(read_channels(file, names, data), data, display);
  } catch (const Error&) {
    throw;
  } catch (const std::exception& problem) {
    fail_read(name, std::string("damaged EXR (") + problem.what() + ")");
  }
}

ImageMetadata read_exr_metadata(const Path& path) {
  ImageMetadata metadata;
  try {
    Imf::InputFile file(path.string().c_str());
    for (auto i = file.header().begin(); i != file.header().end(); ++i)
      if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(&i.attribute()))
        metadata[i.name()] = text->value();
  } catch (const std::exception& problem) {
    fail_read(path.string(), std::string("damaged EXR (") + problem.what() + ")");
  }
  return metadata;
}

}  // namespace detail

void write_exr(const Path& path, const Image& image, bool half, const ImageMetadata& metadata) {
  EFFIGY_CHECK(!image.empty() && image.channels >= 1 && image.channels <= 4);
  write_through(path, [&](const Path& temporary) {
    try {
      Imf::Header header(image.width, image.height);
      header.compression() = Imf::ZIP_COMPRESSION;
      for (const auto& [key, value] : metadata) header.insert(key, Imf::StringAttribute(value));
      const auto count = static_cast<size_t>(image.channels);
      std::vector<Imath::half> halves;
      if (half) {
        // Beyond half's range the largest half, not infinity.
        halves.reserve(image.data.size());
        for (float value : image.data) halves.emplace_back(std::clamp(value, -65504.0f, 65504.0f));
      }
      const size_t value_size = half ? sizeof(Imath::half) : sizeof(float);
      const char* base = half ? reinterpret_cast<const char*>(halves.data())
                              : reinterpret_cast<const char*>(image.data.data());
      constexpr std::array<const char*, 4> names = {"R", "G", "B", "A"};
      Imf::FrameBuffer frame;
      for (size_t c = 0; c < count; ++c) {
        const auto type = half ? Imf::HALF : Imf::FLOAT;
        header.channels().insert(names[c], Imf::Channel(type));
        frame.insert(names[c],
                     Imf::Slice(type, const_cast<char*>(base) + c * value_size, count * value_size,
                                count * value_size * static_cast<size_t>(image.width)));
      }
      Imf::OutputFile file(temporary.string().c_str(), header);
      file.setFrameBuffer(frame);
      file.writePixels(image.height);
    } catch (const std::exception& problem) {
      throw Error("Cannot write " + path.string() + ": " + problem.what() +
                      "; choose another place with -o.",
                  Blame::kResource);
    }
  });
}

}  // namespace effigy
