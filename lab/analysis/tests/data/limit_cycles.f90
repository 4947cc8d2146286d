! The closed loop of the paper's car, P straight on at a speed, for AUTO-07p (limit_cycles.auto).
! U: yaw, yaw rate, sideslip and, under the front-point law, steering. PAR: dl, speed of P, and 1
! for saturating tyres; then the real parts of the multipliers.
      MODULE CAR
        DOUBLE PRECISION, PARAMETER :: M=1.9D0, IZ=0.0251D0, LF=0.1368D0, LR=0.1232D0, &
          CF=58.085D0, CR=130.805D0, P=0.35D0, MU=0.25D0, G=9.80665D0
      END MODULE CAR
      SUBROUTINE FUNC(NDIM,U,ICP,PAR,IJAC,F,DFDU,DFDP)
      USE CAR
      IMPLICIT NONE
      INTEGER, INTENT(IN) :: NDIM, ICP(*), IJAC
      DOUBLE PRECISION, INTENT(IN) :: U(NDIM), PAR(*)
      DOUBLE PRECISION, INTENT(OUT) :: F(NDIM)
      DOUBLE PRECISION, INTENT(INOUT) :: DFDU(NDIM,NDIM), DFDP(NDIM,*)
      DOUBLE PRECISION L, C, V, D, FF, FR, MF, MR
      L = LF + PAR(1)
      IF (NDIM == 4) THEN
        ! Equation 8.
        D = U(4)
        C = COS(U(3) - D)
        V = (COS(U(1) + D)*PAR(2) - U(2)*SIN(D)*L)/C
        F(4) = (-SIN(U(1) + U(3))*PAR(2) - U(2)*COS(U(3))*L)/(C*P) - U(2)
      ELSE
        ! The law of the appendix, with l_f + dl and l_r - dl.
        V = COS(U(1) + U(3))*PAR(2)
        D = -M*V*SIN(U(1) + U(3))*PAR(2)/(P*CF) + U(3)*(CF + CR)/CF &
          - U(2)/V*(CR*(LR - PAR(1)) - CF*L)/CF
      END IF
      FF = CF*(D - U(3) - LF*U(2)/V)
      FR = CR*(-U(3) + LR*U(2)/V)
      IF (PAR(3) > 0.5D0) THEN
        MF = MU*M*G*LR/(LF + LR)
        MR = MU*M*G*LF/(LF + LR)
        FF = MF*TANH(FF/MF)
        FR = MR*TANH(FR/MR)
      END IF
      F(1) = U(2)
      F(2) = (LF*FF - LR*FR)/IZ
      F(3) = (FF + FR)/(M*V) - U(2)
      END SUBROUTINE FUNC
      SUBROUTINE STPNT(NDIM,U,PAR,T)
      IMPLICIT NONE
      INTEGER, INTENT(IN) :: NDIM
      DOUBLE PRECISION, INTENT(INOUT) :: U(NDIM), PAR(*)
      DOUBLE PRECISION, INTENT(IN) :: T
      U = 0D0
      END SUBROUTINE STPNT
      SUBROUTINE PVLS(NDIM,U,PAR)
      IMPLICIT NONE
      INTEGER, INTENT(IN) :: NDIM
      DOUBLE PRECISION, INTENT(IN) :: U(NDIM)
      DOUBLE PRECISION, INTENT(INOUT) :: PAR(*)
      DOUBLE PRECISION, EXTERNAL :: GETP
      INTEGER I
      DO I = 1, NDIM
        PAR(3 + I) = GETP('EIG', 2*I - 1, U)
      END DO
      END SUBROUTINE PVLS
      SUBROUTINE BCND
      END SUBROUTINE BCND
      SUBROUTINE ICND
      END SUBROUTINE ICND
      SUBROUTINE FOPT
      END SUBROUTINE FOPT
