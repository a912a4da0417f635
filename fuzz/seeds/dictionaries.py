"""Words that formats are made of."""

WORDS = {
    "ply": "ply format ascii binary_little_endian binary_big_endian 1.0 comment obj_info element vertex face property list char uchar short ushort "
           "int uint float double int8 uint8 int16 uint16 int32 uint32 float32 float64 x y z red green blue nx ny nz confidence instance end_header",
    "colmap": "SIMPLE_PINHOLE PINHOLE SIMPLE_RADIAL RADIAL OPENCV FULL_OPENCV OPENCV_FISHEYE SIMPLE_RADIAL_FISHEYE RADIAL_FISHEYE THIN_PRISM_FISHEYE FOV "
              "-1 nan inf 1e400 18446744073709551615 4294967296",
    "cameras": "camera_model fl_x fl_y cx cy w h k1 k2 k3 k4 k5 k6 p1 p2 camera_angle_x camera_angle_y frames file_path transform_matrix depth_file_path "
               "views steps name cam_to_world intrinsics scale OPENCV OPENCV_FISHEYE null true 1e308 -1 18446744073709551615",
    "zip": "PK\x03\x04 PK\x01\x02 PK\x05\x06 PK\x06\x06 PK\x06\x07 .png ../ __MACOSX/",
    "npz": "descr fortran_order shape True False <f4 <f8 PK\x01\x02 PK\x05\x06 18446744073709551615",
    "pickle": "torch._utils\n_rebuild_tensor_v2\n collections\nOrderedDict\n torch\nFloatStorage\n storage cpu state_dict model ema args _modules _parameters "
              "_buffers torch\nHalfStorage\n torch\nDoubleStorage\n torch._utils\n_rebuild_parameter\n",
    "safetensors": "__metadata__ dtype shape data_offsets F64 F32 F16 BF16 I64 U32 U8 BOOL F8_E4M3 F4 [0,0] 18446744073709551615",
    "config": "network provenance weights_sha256 null true false 0 1 -1 4294967296 18446744073709551615 1e300 [] {}",
    "scene": "scene.json edits.json instances.json frames held_out stages version generator floor_to_world camera transform photo_size crop_origin crop_size "
             "frame_size edit instance instances placement by to turn_degrees scale parts merge split move duplicate 4294967295 1e308 -1 null",
    "api": "GET POST DELETE HEAD FILE /api/edits /api/estimate /api/jobs /api/gallery/ /continue /cancel /preview/ action instance instances placement by to "
           "turn_degrees scale undo redo split merge cameras view photos path orbit keys between views completion fill none see3d width 4294967295 1e308 -1 null",
    "uploads": "GET POST DELETE /api/uploads/ /api/start /thumbnail segmenter graph mobilesamv2 dtype bf16 f16 f32",
    "list": "[defaults] [[scene]] name recording photos frames test_frames layout inputs tests size measure depth_scale intrinsics clouds points cameras",
}


def quoted(word):
    return "".join(c if 32 < ord(c) < 127 and c not in '"\\' else f"\\x{ord(c):02x}" for c in word)
