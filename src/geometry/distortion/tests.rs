use super::*;
use proptest::prelude::*;

const FREIBURG1: [f64; 5] = [0.2624, -0.9531, -0.0054, 0.0026, 1.1633];
const RATIONAL: [f64; 8] = [0.12, -0.05, 0.001, -0.0007, 0.01, 0.03, -0.02, 0.004];
const POINTS: [[f64; 2]; 3] = [[0.3, -0.2], [-0.55, 0.4], [0.05, 0.61]];

fn assert_near(got: [f64; 2], want: [f64; 2]) {
    let off = (got[0] - want[0]).hypot(got[1] - want[1]);
    assert!(off < 1e-9, "{got:?} for {want:?}");
}

#[test]
fn points_are_bent_as_by_opencv() {
    // cv2.projectPoints and cv2.fisheye.distortPoints (OpenCV 4), camera matrix 1.
    let freiburg1 = [
        [0.30762211402999995, -0.20555807602000004],
        [-0.5627637218652344, 0.4076597522656251],
        [0.05194260654430244, 0.6197946478404897],
    ];
    let rational = [
        [0.30301289284283545, -0.2019392618952237],
        [-0.5706832059689844, 0.41526937706835226],
        [0.051273487685404205, 0.6291102337619312],
    ];
    for (coefficients, wanted) in [(&FREIBURG1[..], freiburg1), (&RATIONAL, rational)] {
        let distortion = Distortion::from_opencv(coefficients).unwrap();
        for (point, wanted) in POINTS.iter().zip(wanted) {
            assert_near(distortion.distort(*point), wanted);
            assert_near(distortion.undistort(wanted).unwrap(), *point);
        }
    }
    let fisheye = Distortion::fisheye([-0.03, 0.012, -0.006, 0.0011]).unwrap();
    for (point, wanted) in [
        ([0.3, -0.2], [0.2869407251863566, -0.1912938167909044]),
        ([-1.4, 0.9], [-0.8453502581765889, 0.5434394516849501]),
        ([0.1, 2.2], [0.05046678139701241, 1.110269190734273]),
    ] {
        assert_near(fisheye.distort(point), wanted);
        assert_near(fisheye.undistort(wanted).unwrap(), point);
    }
}

#[test]
fn what_lies_beyond_the_fold_has_no_ray_and_is_not_seen() {
    // r (1 - r²/3) has its largest value, 2/3, at r = 1, and comes back from there.
    let distortion = Distortion::from_opencv(&[-1.0 / 3.0]).unwrap();
    assert_eq!(distortion.undistort([0.7, 0.0]), None);
    let near = distortion.undistort([0.6, 0.0]).unwrap()[0];
    assert!((near - near.powi(3) / 3.0 - 0.6).abs() < 1e-9 && near < 1.0);
    let lens = DistortedLens {
        intrinsics: Intrinsics {
            width: 101,
            height: 101,
            fx: 60.0,
            fy: 60.0,
            cx: 50.0,
            cy: 50.0,
        },
        distortion,
    };
    assert!(lens.image_point([0.9, 0.0]).is_some());
    assert_eq!(lens.image_point([1.2, 0.0]), None, "folded back");
    assert_eq!(lens.image_point([0.0, -1.5]), None, "folded back");
    let pinhole = DistortedLens {
        distortion: Distortion::None,
        ..lens
    };
    assert_eq!(pinhole.image_point([0.5, 0.0]), Some([80.0, 50.0]));
    assert_eq!(pinhole.image_point([0.9, 0.0]), None, "outside");
    let wide = Distortion::fisheye([0.0; 4]).unwrap();
    assert_eq!(wide.undistort([1.6, 0.0]), None, "behind the lens");
}

#[test]
fn coefficients_are_checked_and_zeros_are_no_distortion() {
    assert_eq!(Distortion::from_opencv(&[0.0; 5]), Ok(Distortion::None));
    assert!(Distortion::from_opencv(&[0.0; 9]).is_err());
    assert!(Distortion::from_opencv(&[f64::NAN]).is_err());
    assert!(Distortion::fisheye([0.0, f64::INFINITY, 0.0, 0.0]).is_err());
}

proptest! {
    #[test]
    fn undistort_is_the_inverse(
        x in -0.5..0.5f64, y in -0.5..0.5f64,
        k1 in -0.3..0.3f64, k2 in -0.2..0.2f64, p in prop::array::uniform2(-0.01..0.01f64),
    ) {
        for distortion in [
            Distortion::from_opencv(&[k1, k2, p[0], p[1]]).unwrap(),
            Distortion::fisheye([k1 / 3.0, k2 / 3.0, 0.0, 0.0]).unwrap(),
        ] {
            let back = distortion.undistort(distortion.distort([x, y])).unwrap();
            prop_assert!((back[0] - x).hypot(back[1] - y) < 1e-8);
        }
    }

    #[test]
    fn whatever_the_numbers_there_is_an_inverse_or_none(
        at in prop::array::uniform2(-9.0..9.0f64), k in prop::array::uniform8(-5.0..5.0f64),
    ) {
        for distortion in [
            Distortion::from_opencv(&k).unwrap(),
            Distortion::fisheye([k[0], k[1], k[2], k[3]]).unwrap(),
        ] {
            if let Some(ray) = distortion.undistort(at) {
                let again = distortion.distort(ray);
                prop_assert!((again[0] - at[0]).hypot(again[1] - at[1]) < 1e-6);
            }
        }
    }
}
