# Every outside library, once, with the reason. The Debian package names live in scripts/packages.txt.

find_package(PkgConfig REQUIRED)
find_package(Threads REQUIRED)
find_package(spdlog REQUIRED)        # base: log lines
find_package(OpenMP REQUIRED)        # base: threads
find_package(Eigen3 REQUIRED NO_MODULE)  # geometry: small vectors, sparse matrices
find_package(embree 3 REQUIRED)      # rays: ray queries on meshes
find_package(PNG REQUIRED)           # image: PNG, 8 and 16 bit
find_package(JPEG REQUIRED)          # image: JPEG
find_package(OpenEXR REQUIRED)       # image: EXR
find_package(nlohmann_json REQUIRED) # base: JSON files
find_package(TinyGLTF REQUIRED)      # people: the user's glTF bodies
find_package(CLI11 REQUIRED)         # cli: arguments
pkg_check_modules(HWY REQUIRED IMPORTED_TARGET libhwy)        # base: SIMD kernels
pkg_check_modules(AVIF REQUIRED IMPORTED_TARGET libavif)      # image: AVIF frames of imported captures
pkg_check_modules(LIBZIP REQUIRED IMPORTED_TARGET libzip)     # base: npz and model bundles
pkg_check_modules(FFMPEG REQUIRED IMPORTED_TARGET
                  libavformat libavcodec libavutil libswscale) # image/video: decode and encode
if(EFFIGY_LEARN)
  # Caffe2's CMake files call find_package(CUDA) loudly; the Debian build has none.
  find_package(Torch REQUIRED)       # infer, learn: tensors, networks
  find_package(Ceres REQUIRED)       # track, body: non-linear least squares
  set(MPI_CXX_SKIP_MPICXX TRUE)      # only MPI's functions, not its old C++ classes
  find_package(MPI REQUIRED COMPONENTS CXX)  # learn: training on more than one machine
endif()
if(EFFIGY_TESTS)
  find_package(GTest REQUIRED)
endif()
